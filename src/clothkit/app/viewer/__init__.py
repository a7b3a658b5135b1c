"""The page that plays sessions: scenes as plain arrays, and the code that draws them in a browser."""
