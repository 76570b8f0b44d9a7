"""From a model to its compensation law, by algebra."""
