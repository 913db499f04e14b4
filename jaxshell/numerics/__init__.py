"""What knows nothing of shells: rotations, products of small matrices, checks, and what compilers need to be told."""
