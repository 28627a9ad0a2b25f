"""E57: pages, records, scans."""
