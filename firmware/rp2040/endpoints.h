// What the files of the USB device know of each other: usb.c the bus and endpoint 0, usbdata.c the rest, usbframe.c
// when.

#ifndef ANNULUS_ENDPOINTS_H
#define ANNULUS_ENDPOINTS_H

#include <stdbool.h>
#include <stdint.h>

#define USB_PACKET 64U

// Endpoints, as bits of BUFF_STATUS and EP_ABORT and as places of the buffer control registers.
enum { CONTROL_IN = 0, CONTROL_OUT = 1, NOTICE_IN = 2, DATA_IN = 4, DATA_OUT = 5 };
enum { DATA_IN_SECOND = 6 };  // no endpoint: another buffer of DATA_IN's
#define BIT(endpoint) (1U << (endpoint))

// Buffers. One belongs to the controller from usb_hand_over until BUFF_STATUS says it is done.
void usb_hand_over(uint32_t endpoint, uint32_t bits);
uint32_t usb_take_back(uint32_t endpoints);                  // which of them were not done
void usb_void_control(void);                                 // endpoint 0's; what was done before is still said to be
void usb_place_packets(uint32_t endpoint, uint32_t buffer);  // the endpoint on, its next packet in this buffer
volatile uint8_t* usb_packet_of(uint32_t buffer);            // an endpoint's own, or DATA_IN_SECOND
void usb_copy_out(uint32_t buffer, uint32_t at, const uint8_t* bytes, uint32_t size);

// The port, as control requests and the bus see it.
extern struct usb_port {
    bool configured;
    bool suspended;
    bool host_ready;  // DTR
    uint8_t halted;   // BIT(endpoint)
} usb_port;
void usb_port_open(void);
void usb_port_close(void);
void usb_port_ready(bool ready);  // DTR
void usb_port_forget(void);       // as closed, with a controller that nothing can be taken back from
bool usb_port_halted(uint32_t endpoint);
void usb_port_halt(uint32_t endpoint, bool halt);
void usb_port_done(uint32_t endpoints);  // buffers the controller has given back
void usb_port_flush(void);               // what is filled goes, at the end of a round

// Frames, while the bus is awake; usb_frame_wake when it begins to be.
void usb_frame_wake(void);
bool usb_frame_early(void);    // there is time in this one for a packet of bulk in to be handed over and fetched
bool usb_frame_overdue(void);  // the next one should have begun long ago: the controller hangs

#endif
