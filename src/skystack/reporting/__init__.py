"""What a reader sees of a run: tables, figures and the HTML report, from what evaluation wrote."""
