"""Study files: cases, keys that vary, designs."""
