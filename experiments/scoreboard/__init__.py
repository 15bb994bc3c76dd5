"""What every engine answers when several bodies meet at once, and which exact law explains it."""
