"""How sure the motion is."""
