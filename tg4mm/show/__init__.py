"""Output of a run for people: pictures, measurements, reports, viewers, exported files."""
