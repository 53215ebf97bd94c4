"""The only disk access for datasets: atomic shards, manifests, resume, on local disks or object storage."""
