"""pEM*D and VtM, and what trains them."""
