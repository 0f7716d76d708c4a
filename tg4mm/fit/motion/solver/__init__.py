"""The least-squares problem and how it is solved."""
