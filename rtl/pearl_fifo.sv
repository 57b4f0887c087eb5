// SPDX-License-Identifier: MIT
// A first-in, first-out queue whose oldest entry is visible before it is taken.
//
// It neither refuses nor signals an overflow: who fills it counts.
module pearl_fifo #(
    parameter int unsigned WIDTH = 32,
    // A power of two, so that the pointers wrap by themselves.
    parameter int unsigned DEPTH = 8
) (
    input  logic             clk_i,
    input  logic             rst_ni,
    input  logic             push_i,
    input  logic [WIDTH-1:0] data_i,
    output logic             valid_o,
    output logic [WIDTH-1:0] data_o,
    input  logic             pop_i
);

  if (DEPTH < 2 || DEPTH != 2 ** $clog2(DEPTH)) begin : gen_illegal_depth
    $error("DEPTH is %0d; possible are the powers of two from 2 on", DEPTH);
  end

  localparam int unsigned PTR_BITS = $clog2(DEPTH);

  logic [WIDTH-1:0] mem[DEPTH];
  logic [PTR_BITS:0] head_q, tail_q, count;

  always_ff @(posedge clk_i) begin
    if (push_i) mem[head_q[PTR_BITS-1:0]] <= data_i;
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      head_q <= '0;
      tail_q <= '0;
    end else begin
      if (push_i) head_q <= head_q + 1'b1;
      if (pop_i) tail_q <= tail_q + 1'b1;
    end
  end

  assign valid_o = head_q != tail_q;
  assign data_o  = mem[tail_q[PTR_BITS-1:0]];

  assign count   = head_q - tail_q;
  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (32'(count) < DEPTH || !push_i)
      else $error("pearl_fifo: an entry came when there was no room for it");
      assert (valid_o || !pop_i)
      else $error("pearl_fifo: an entry was taken when there was none");
    end
  end

endmodule
