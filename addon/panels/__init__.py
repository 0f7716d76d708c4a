"""What the sidebar and the view show, and the pictures in them."""
