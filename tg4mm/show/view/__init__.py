"""`tg4mm view`: a run in the browser, its motion magnified as it plays; served to 127.0.0.1 alone."""
