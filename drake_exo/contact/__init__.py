"""Force laws and their derivatives, and LeafSystems around them."""
