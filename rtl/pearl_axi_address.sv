// The address of a burst's next beat, for AXI4's FIXED, INCR and WRAP.
module pearl_axi_address #(
    parameter int unsigned ADDR_BITS = 16
) (
    input  logic [ADDR_BITS-1:0] addr_i,
    input  logic [          7:0] len_i,
    input  logic [          2:0] size_i,
    input  logic [          1:0] burst_i,
    output logic [ADDR_BITS-1:0] next_o
);

  localparam logic [1:0] BURST_FIXED = 2'b00;
  localparam logic [1:0] BURST_WRAP = 2'b10;
  // 256 beats of 128 bytes are the longest burst there is.
  localparam int unsigned SPAN_BITS = 16;

  logic [SPAN_BITS-1:0] beats, span;
  logic [ADDR_BITS-1:0] bytes, aligned, incremented, wrap_mask;

  // A small map has fewer address bits than the longest burst, which then wraps over all of it.
  logic unused_span;
  assign unused_span = ^span;

  assign beats = SPAN_BITS'(len_i) + 1'b1;
  assign span = beats << size_i;
  assign bytes = ADDR_BITS'(1) << size_i;
  // Only the first beat of a burst can be unaligned.
  assign aligned = addr_i & ~(bytes - 1'b1);
  assign incremented = aligned + bytes;
  assign wrap_mask = ADDR_BITS'(span) - 1'b1;

  always_comb begin
    unique case (burst_i)
      BURST_FIXED: next_o = addr_i;
      BURST_WRAP: next_o = (addr_i & ~wrap_mask) | (incremented & wrap_mask);
      default: next_o = incremented;
    endcase
  end

endmodule
