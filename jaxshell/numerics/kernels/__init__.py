"""Functions of one element over all of them, as vector code: by XLA, or compiled apart by LLVM."""

from jaxshell.numerics.kernels.each import each, kernels, kernels_chosen

__all__ = ["each", "kernels", "kernels_chosen"]
