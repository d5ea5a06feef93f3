"""Reading and writing recordings by presentation timestamp. The only package that imports PyAV."""
