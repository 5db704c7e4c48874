"""The verb `export`: flown scenarios and trained policies as files for other programs."""
