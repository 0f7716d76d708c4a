"""The sidebar's panels, the overlay in the 3D view, and their pictures."""
