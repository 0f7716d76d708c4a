"""What is found out before the fit: noise, pixels' weights, how stiff the prior is."""
