"""What a person sees of a run: pictures, measurements, reports, viewers, exported files."""
