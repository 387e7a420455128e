"""The machine: processes, memory, and what is kept on disk."""
