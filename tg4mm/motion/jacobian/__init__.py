"""How pictures answer to small motions."""
