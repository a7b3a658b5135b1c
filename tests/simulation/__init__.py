"""Tests of clothkit.simulation."""
