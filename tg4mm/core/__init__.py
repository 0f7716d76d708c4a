"""What all stands on: errors, files, checked values, pictures, pages, splat files, magnification."""
