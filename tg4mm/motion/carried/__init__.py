"""What pictures show of motion beyond the derivative of the Gaussians at rest."""
