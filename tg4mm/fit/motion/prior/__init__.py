"""The prior on motion: squared second-order total generalised variation on a graph of neighbours."""
