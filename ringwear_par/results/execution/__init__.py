"""From a case to its result: the recorder, commands, checkpoints."""
