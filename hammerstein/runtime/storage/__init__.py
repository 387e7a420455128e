"""Files on the disk that are written whole, together, and never over somebody else's."""
