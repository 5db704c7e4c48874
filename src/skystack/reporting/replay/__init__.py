"""The radar replay: what was flown and said, as a page, pictures and films."""
