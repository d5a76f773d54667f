"""Files: ordinary ones only, texts, tables of readings, and what is written whole or not at all."""
