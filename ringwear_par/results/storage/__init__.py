"""Result files, exports."""
