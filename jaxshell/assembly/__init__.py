"""From elements to the structure: tables, sparsity, and the discretised model."""
