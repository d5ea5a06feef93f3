"""Where jobs meet the world: the database, the data folder and the queue. Used by api, worker and cli alone."""
