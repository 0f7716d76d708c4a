"""What is read of a benchmark: tables, plots, pictures, and the pages that hold them."""
