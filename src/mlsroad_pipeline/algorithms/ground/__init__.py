"""Ground points told from the rest."""
