"""The report's page as Markdown."""
