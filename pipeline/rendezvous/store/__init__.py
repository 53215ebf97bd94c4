"""The only disk access for datasets: atomic shards, manifests, resume; folders or object storage."""
