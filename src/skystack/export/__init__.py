"""The verb `export`: flown scenarios and trained policies in the files of other programs."""
