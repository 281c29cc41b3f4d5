// The loader as it was linked by itself, in front of the application.
    .section .loader_image, "a"
    .incbin "loader.bin"
