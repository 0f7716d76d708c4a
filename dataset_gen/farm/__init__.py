"""Scale-out: the same commands on one machine's cores, a cluster (Snakemake) or a render farm (Flamenco)."""
