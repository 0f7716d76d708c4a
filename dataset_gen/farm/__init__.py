"""Scale-out: the same commands on one machine's cores, a cluster (Snakemake) or a render farm (Flamenco).

`commands` is the one place that knows the commands; `Snakefile` asks `sets` for them, and `tg4mm_dataset.js`
authors the same ones, which a test holds.
"""
