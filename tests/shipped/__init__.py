"""What makes the files that are shipped with the package."""
