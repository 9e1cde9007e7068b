"""Report pages: self-contained HTML of text, tables and figures, and numbers as people read them."""
