"""Sections, faces and meshes."""
