"""Pure measuring functions: arrays in, results out. No devices, threads, clocks or files."""
