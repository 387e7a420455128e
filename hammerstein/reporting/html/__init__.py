"""Pages for a browser: one file each, that fetches nothing and reads well without scripts."""
