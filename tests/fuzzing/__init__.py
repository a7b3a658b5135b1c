"""Every loader and every command on mutated inputs."""
