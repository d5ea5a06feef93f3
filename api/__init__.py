"""The HTTP front end: routes and schemas, thin. It never imports torch, and runs no stage."""
