"""Episodes: agents and worlds in turn, and what they leave as arrays and rows (section 5.1)."""
