"""A run as one HTML page that plays it in any browser, without Python and without network. docs/web.md.

`write.py` makes the page from a run: `scene.py` says what is in it (JSON), `pack.py` holds the Gaussians (binary),
`factor.py` their motion. `player/` is the page's program, JavaScript; `player/dist` what `npm run build` made of it.
"""
