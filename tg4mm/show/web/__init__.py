"""A run as one HTML page that plays it in any browser, without Python and without network. docs/web.md.

`write.py` makes the page from a run, and `pack.py` packs the Gaussians (binary) within a size.
`player/` is the page's program, JavaScript; `player/dist` what `npm run build` made of it.
"""
