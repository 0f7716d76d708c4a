"""The stages of a run of the preset `modal`: each fits, keeps its checkpoint in the run folder and saves what it found.

The fits themselves (`tg4mm.fit.space`, `tg4mm.fit.motion`) know of no run folder.
"""
