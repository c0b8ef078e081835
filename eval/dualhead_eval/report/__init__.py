"""Reports of gates: computed once, rendered for a terminal and as a page, with figures."""
