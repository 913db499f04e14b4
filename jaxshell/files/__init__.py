"""Scene files, and how objects are quoted in files."""
