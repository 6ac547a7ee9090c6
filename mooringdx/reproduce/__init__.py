"""Source papers carried out anew: their figures and claims beside what is measured here, one paper a file."""
