"""What the user states: mesh, sections, supports, loads, scene."""
