// SPDX-License-Identifier: MIT
// The addresses of a burst's beats, for AXI4's FIXED, INCR and WRAP.
//
// What a burst's kind, size and length say of its addresses is worked out in a cycle of its own, so
// that there is no more than an adder and a mask from one beat to the next.
module pearl_axi_address #(
    parameter int unsigned ADDR_BITS = 16
) (
    input  logic                 clk_i,
    input  logic                 rst_ni,
    // A burst; the address of its first beat is there in the next cycle, and can be moved on from in the
    // cycle after that.
    input  logic                 start_i,
    input  logic [ADDR_BITS-1:0] addr_i,
    input  logic [          7:0] len_i,
    input  logic [          2:0] size_i,
    input  logic [          1:0] burst_i,
    input  logic                 next_i,
    output logic [ADDR_BITS-1:0] addr_o
);

  localparam logic [1:0] BURST_FIXED = 2'b00;
  localparam logic [1:0] BURST_WRAP = 2'b10;
  // A beat is of 128 bytes at most, a burst of 256 beats.
  localparam int unsigned BEAT_BITS = 7;
  localparam int unsigned SPAN_BITS = 15;

  logic [7:0] len_q;
  logic [2:0] size_q;
  logic [1:0] burst_q;
  logic [ADDR_BITS-1:0] addr_q, within_beat_q, kept_q, incremented;

  logic [BEAT_BITS-1:0] within_beat;
  logic [SPAN_BITS-1:0] within_span;
  // A small map has fewer address bits than the longest burst, which then wraps over all of it.
  logic unused_span;
  assign unused_span = ^{within_beat, within_span};

  // A wrapping burst has 2, 4, 8 or 16 beats, so that its length, less one, is a mask.
  assign within_beat = ~(BEAT_BITS'('1) << size_q);
  assign within_span = SPAN_BITS'(len_q) << size_q | SPAN_BITS'(within_beat);

  // Only the first beat of a burst can be unaligned.
  assign incremented = (addr_q | within_beat_q) + 1'b1;

  always_ff @(posedge clk_i) begin
    if (start_i) begin
      len_q   <= len_i;
      size_q  <= size_i;
      burst_q <= burst_i;
    end
    within_beat_q <= ADDR_BITS'(within_beat);
    unique case (burst_q)
      BURST_FIXED: kept_q <= '1;
      BURST_WRAP: kept_q <= ~ADDR_BITS'(within_span);
      default: kept_q <= '0;
    endcase
    if (start_i) addr_q <= addr_i;
    else if (next_i) addr_q <= (addr_q & kept_q) | (incremented & ~kept_q);
  end

  assign addr_o = addr_q;

  logic start_q;
  always_ff @(posedge clk_i) begin
    start_q <= start_i;
    if (rst_ni && next_i) begin
      assert (!start_q)
      else $error("pearl_axi_address: a burst was moved on from before it was worked out");
    end
  end

endmodule
