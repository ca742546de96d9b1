"""How episodes begin: seeds, graphs, fields, places; drawn before anything is written."""
