"""Run time: processes, memory, and the cache on disk."""
