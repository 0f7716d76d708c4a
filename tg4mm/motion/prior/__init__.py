"""What motion is likely: neighbours move alike."""
