"""Pages of a benchmark with tables, plots and pictures."""
