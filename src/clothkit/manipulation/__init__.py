"""Manipulations: their representation as 6-vectors, trajectories of the hands, grasp candidates and sampling."""
