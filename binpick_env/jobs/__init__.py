"""What every long job shares: processes, claimed folders, tables of text, the style of reports."""
