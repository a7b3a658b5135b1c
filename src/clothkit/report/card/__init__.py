"""The dataset card: raw artifacts described for someone who has never heard of this project."""
