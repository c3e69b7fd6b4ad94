"""fri_client."""
