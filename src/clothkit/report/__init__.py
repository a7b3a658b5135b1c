"""Tables and figures from tidy rows; nothing is computed here."""
