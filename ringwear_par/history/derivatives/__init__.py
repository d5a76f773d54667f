"""What histories have derivatives with respect to."""
