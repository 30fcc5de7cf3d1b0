"""The report of a recorded session: one HTML file that needs nothing else."""
