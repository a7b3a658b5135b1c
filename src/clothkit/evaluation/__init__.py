"""Evaluation of estimation, prediction and planning, one module per question; each returns tidy rows."""
