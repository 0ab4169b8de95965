"""Force laws written once, and the LeafSystems around them."""
