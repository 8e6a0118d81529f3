"""What an Object File holds, and how it is read: header, tensors, surface, arguments of queries."""
