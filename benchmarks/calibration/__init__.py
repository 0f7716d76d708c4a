"""Are the errors that are printed true? Random films through the whole program, scored against exact truth."""
