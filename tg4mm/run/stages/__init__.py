"""The stages of a run of the preset `modal`: each fits, keeps its checkpoint in the run folder."""
