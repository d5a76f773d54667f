"""Case files and their keys."""
