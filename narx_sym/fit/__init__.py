"""Numbers from records: simulation, estimation, selection, identification, laws over a reference."""
