"""The planning loss, its uncertainty term, the gradient-based search for plans, and sessions of plan and execution."""
