"""Parts of a page: its frame, its tables, its interactive region. All is in the file; nothing is fetched."""
