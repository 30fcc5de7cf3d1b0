"""Is the guide on the tube: offset, tilt, parallelism, entry, each with its sigma; verdicts and alarms."""
