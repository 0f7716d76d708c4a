"""What changes in the pictures over time."""
