"""Models of Nastran bulk data files, as tables of a scene file."""
