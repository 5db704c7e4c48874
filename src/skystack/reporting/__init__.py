"""Reports on a run: tables, figures and an HTML page, made from the files that evaluation wrote."""
