// SPDX-License-Identifier: MIT
// The design's interrupt as the XDMA core takes one: raised when a step has ended, and held until the
// core has sent it (PG195, "MSI and Internal MSI-X Interrupts"), which a host that polls may not wait for.
//
// The interrupt is another clock's, and low for longer than it takes to come across between two steps.
module pearl_xdma_irq (
    input  logic clk_i,
    input  logic rst_ni,
    input  logic irq_i,
    output logic usr_irq_req_o,
    // For a cycle, when the request was sent.
    input  logic usr_irq_ack_i
);

  typedef enum logic [1:0] {
    Idle,
    // Requested, and not sent yet.
    Request,
    // Sent; the host has yet to ring again.
    Serve
  } state_e;

  state_e state_d, state_q;
  (* ASYNC_REG = "TRUE" *) logic [1:0] irq_q;
  logic irq;
  assign irq = irq_q[1];

  always_comb begin
    state_d = state_q;
    unique case (state_q)
      Idle: if (irq) state_d = Request;
      // If the host has rung again by then, and that step has ended too, one is for both.
      Request: if (usr_irq_ack_i) state_d = Serve;
      Serve: if (!irq) state_d = Idle;
      default: state_d = Idle;
    endcase
  end

  always_ff @(posedge clk_i) irq_q <= {irq_q[0], irq_i};

  always_ff @(posedge clk_i) begin
    if (!rst_ni) state_q <= Idle;
    else state_q <= state_d;
  end

  assign usr_irq_req_o = state_q != Idle;

endmodule
