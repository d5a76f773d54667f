"""Wear histories of ring-on-ring and ring-on-disc tests by boundary elements, on MPI and PETSc.

Modules follow the paper (Serre, Bonnet and Pradeilles-Duval 2001): schema, case, geometry, kernels,
quadrature, assembly, body, pair, contact, wear, history. Units: mm, N, MPa, s, rad; energies N mm.
"""

__version__ = "0.1.0"
