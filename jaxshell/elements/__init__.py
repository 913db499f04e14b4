"""The shell element: membrane, bending, corotational frame and inertia, each written for one triangle."""
