"""Prebuilt nets: trained nets packed small enough for a repository, and unpacked where nobody has trained any."""
