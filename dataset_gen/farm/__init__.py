"""Scale-out: the same commands on one machine's cores or on a cluster, by Snakemake."""
