"""Changes of appearance that go with the motion: gloss and shadows, as colours of the Gaussians over time."""
