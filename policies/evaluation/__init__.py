"""The main job: bins picked and judged, records, statistics, summaries."""
