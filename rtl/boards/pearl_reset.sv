// SPDX-License-Identifier: MIT
// The reset of a board's design. It falls and rises with the clock, since an address that changes beside
// an edge can cost a memory a word; and it falls however short the clock was gone.
module pearl_reset (
    input  logic clk_i,
    // The clock can be used; may come and go at any time.
    input  logic ready_i,
    // For at least a cycle; pearl_backbone makes of it what it takes to drain.
    output logic rst_no
);

  // Cleared without a clock, perhaps just beside an edge: that ends in the next two.
  (* ASYNC_REG = "TRUE" *) logic [1:0] ready_q;
  (* ASYNC_REG = "TRUE" *) logic [1:0] steady_q;

  // What an FPGA's flip-flops start with: its design begins in reset, which no other reset could say. It
  // stands here because no `initial` may write what an always_ff does.
  // verilator lint_off PROCASSINIT
  logic rst_nq = 1'b0;
  // verilator lint_on PROCASSINIT

  always_ff @(posedge clk_i or negedge ready_i) begin
    if (!ready_i) ready_q <= '0;
    else ready_q <= {ready_q[0], 1'b1};
  end

  always_ff @(posedge clk_i) begin
    steady_q <= {steady_q[0], ready_q[1]};
    rst_nq   <= steady_q[1];
  end

  assign rst_no = rst_nq;

endmodule
