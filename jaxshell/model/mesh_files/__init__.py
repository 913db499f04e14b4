"""Mesh files, a format each: points, cells and sets as the file has them."""
