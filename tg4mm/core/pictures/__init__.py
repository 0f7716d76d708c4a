"""Picture files in and out: PNG of 8 and 16 bits, JPEG, EXR."""
