"""Pages, charts and their style: what reports of runs and of datasets are made of."""
