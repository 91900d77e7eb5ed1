"""Assembly manuals for people: line drawings of every step, as a PDF and as a page."""
