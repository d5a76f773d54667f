"""What a history leaves: variables, files, figures, tables."""
