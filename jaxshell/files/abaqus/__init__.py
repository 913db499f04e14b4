"""Models of Abaqus and CalculiX input files, as tables of a scene file."""
