"""Compiled CPU kernels behind the functions of :mod:`navrl.ops`; nobody else calls them.

Each module holds small scalar functions and the loops over worlds made from them. The readable
torch forms in :mod:`navrl.ops` are their oracle.
"""
