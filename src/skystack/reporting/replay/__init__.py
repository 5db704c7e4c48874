"""The radar replay of recorded flights and clearances: a page, stills and films."""
