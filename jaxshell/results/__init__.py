"""What runs give back: solutions, result files, and what is computed from them."""
