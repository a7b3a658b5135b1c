"""The page on which sessions are played: what it shows as plain arrays, and what draws that in a browser."""
